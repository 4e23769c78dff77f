use panopath::{Tracks, positions::trial};
struct R(u64);
impl R { fn n(&mut self)->f64{ self.0=self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407); let x=((self.0>>33)^self.0)>>11; (x as f64)/(1u64<<53) as f64 } fn g(&mut self)->f64{ (-2.0*(1.0-self.n()).ln()).sqrt()*(6.283185307*self.n()).cos() } }
fn main(){
  let a:Vec<f64>=std::env::args().skip(2).map(|x|x.parse().unwrap()).collect(); let kind=std::env::args().nth(1).unwrap();
  let (m,n,outl,noise)=(a[0] as usize,a[1] as usize,a[2],a[3].to_radians());
  let mut r=R(7+a.get(4).copied().unwrap_or(0.0) as u64*1000003); for _ in 0..10{r.n();}
  let mut c=vec![]; 
  if kind=="street" { let rad=m as f64/6.283185307; for i in 0..m { let t=6.283185307*i as f64/m as f64; c.push([rad*t.cos()+0.1*r.g(),rad*t.sin()+0.1*r.g(),0.05*r.g()]); } }
  else { let (mut x,mut y,mut h)=(4.0,3.0,0.0f64); for _ in 0..m { h+=0.3*r.g(); x+=0.1*h.cos(); y+=0.1*h.sin(); if x<0.5||x>7.5||y<0.5||y>5.5 { x=x.clamp(0.5,7.5); y=y.clamp(0.5,5.5); h+=2.0+r.n(); } c.push([x,y,1.5+0.05*r.g()]); } }
  let (mut vi,mut tr,mut be)=(vec![],vec![],vec![]);
  for j in 0..n {
    let (p,vs):([f64;3],Vec<usize>) = if kind=="street" { let i=(r.n()*m as f64) as usize; let d=200f64.powf(r.n()); let az=6.283185307*r.n(); let el=(-25.0+85.0*r.n()).to_radians();
      let p=[c[i][0]+d*el.cos()*az.cos(),c[i][1]+d*el.cos()*az.sin(),c[i][2]+d*el.sin()];
      let k=(3.0+ (12.0*(d.ln()/200f64.ln()*0.5+0.5*r.n()))) as usize; let k=k.min(15).max(3); let s=i+m-k/2; (p,(0..k).map(|q|(s+q)%m).collect()) }
    else { let i=(r.n()*m as f64) as usize; let wall=(r.n()*4.0) as usize; let (u,z)=(r.n(),2.6*r.n()); let p=match wall {0=>[8.0*u,0.0,z],1=>[8.0*u,6.0,z],2=>[0.0,6.0*u,z],_=>[8.0,6.0*u,z]};
      let mut d:Vec<(f64,usize)>=(0..m).map(|q|{ let e=[c[q][0]-c[i][0],c[q][1]-c[i][1]]; (e[0]*e[0]+e[1]*e[1],q)}).collect(); d.select_nth_unstable_by(60.min(m-1),|a,b|a.0.total_cmp(&b.0)); d.truncate(60);
      let k=3+(12.99*r.n()) as usize; let mut vs=vec![]; while vs.len()<k { let q=d[(r.n()*60.0) as usize%d.len()].1; if !vs.contains(&q){vs.push(q);} } (p,vs) };
    for i in vs { let u=[p[0]-c[i][0],p[1]-c[i][1],p[2]-c[i][2]]; let mut b=panopath::geometry::normalized(&u); if r.n()<outl { b=panopath::geometry::normalized(&[r.g(),r.g(),r.g()]); } else { for q in 0..3 { b[q]+=noise*r.g(); } b=panopath::geometry::normalized(&b); } vi.push(i as u32); tr.push(j as u32); be.push(b); } }
  let nobs=vi.len();
  let t=Tracks::<3>::new(vi,tr,be,None,m,n).unwrap();
  for _ in 0..3 { let k=std::time::Instant::now(); let (e,tm,it,s)=trial(&t,None); let el=k.elapsed().as_secs_f64();
    let mean=|v:&Vec<[f64;3]>|{let mut q=[0.0;3]; for x in v{for i in 0..3{q[i]+=x[i]/m as f64;}} q}; let (mc,me)=(mean(&c),mean(&e)); let (mut ab,mut aa)=(0.0,0.0); for i in 0..m{for q in 0..3{ab+=(e[i][q]-me[q])*(c[i][q]-mc[q]);aa+=(e[i][q]-me[q]).powi(2);}} let sc=ab/aa; let mut er=0.0; for i in 0..m{for q in 0..3{er+=((e[i][q]-me[q])*sc-(c[i][q]-mc[q])).powi(2);}}
    println!("{nobs} obs  {el:.3}s rms {:.6} it {it} sigma {:.5} deg {:?}",(er/m as f64).sqrt(),s.to_degrees(),tm); }
}
